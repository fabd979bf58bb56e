"""Outcome codes of a registration."""

from __future__ import annotations

import enum


class Outcome(enum.IntEnum):
    """Outcome of a registration; only `registered` comes with an update. `.message` is the full sentence."""

    registered = 0
    no_overlap = 1
    unknown_ground = 2
    too_small = 3
    no_texture = 4
    off_reference = 5
    no_agreement = 6
    few_agree = 7
    ambiguous = 8
    beyond_prior = 9
    does_not_fit = 10
    not_settled = 11
    too_vague = 12

    @property
    def message(self) -> str:
        """The outcome as a full sentence."""
        return _MESSAGES[self]


_MESSAGES = {
    Outcome.registered: "The image is registered: enough blocks agree on one pose, and no other explains as many.",
    Outcome.no_overlap: "The image, as the navigation has it, does not lie on the reference; is it the right area?",
    Outcome.unknown_ground: "The elevation model does not cover what the image and the reference share.",
    Outcome.too_small: "Too little of the image lies on the reference for blocks to be matched.",
    Outcome.no_texture: "The image or the reference is too even to be matched: water, snow, fog or a blank part.",
    Outcome.off_reference: "Most of the image lies where the reference shows nothing.",
    Outcome.no_agreement: "Blocks agree on no pose more than by chance: another area, season or scale, or clouds.",
    Outcome.few_agree: "Too few of the blocks agree on one pose: clouds, another season, or a wrong elevation model.",
    Outcome.ambiguous: "Two poses explain about as many blocks: the texture repeats itself.",
    Outcome.beyond_prior: "The pose found is none that the navigation's errors allow: a wrong match, or wrong sigmas.",
    Outcome.does_not_fit: (
        "The ties do not fit one pose within their errors: is the camera, its lens, the terrain or the reference wrong?"
    ),
    Outcome.not_settled: "The pose still changes from pass to pass.",
    Outcome.too_vague: "The errors given leave so much room that it cannot be searched: give smaller sigmas.",
}
