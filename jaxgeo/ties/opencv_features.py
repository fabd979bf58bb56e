"""Keypoints of OpenCV: SIFT and ORB."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from jaxgeo.ties.features import AbstractFeatures, Keypoints

STRETCHED = 0.5, 99.5  # per cent of the grey values that OpenCV's 8 bits begin and end with
FINEST = 1.2  # ratio of neighbouring levels of ORB's pyramid


@dataclass(frozen=True)
class SiftFeatures(AbstractFeatures):
    """SIFT of Lowe (2004), "Distinctive image features from scale-invariant keypoints", as OpenCV has it.

    `contrast` is the least contrast of a keypoint (OpenCV's contrastThreshold). Raises `ImportError` without OpenCV,
    the extra `features`.
    """

    contrast: float = 0.04

    def find(self, grey: np.ndarray, known: np.ndarray) -> Keypoints:
        """See `AbstractFeatures`."""
        # Without the precise upscaling, keypoints are a quarter of a pixel off (OpenCV 4 and 5).
        return _found(opencv().SIFT_create(contrastThreshold=self.contrast, enable_precise_upscale=True), grey, known)


@dataclass(frozen=True)
class OrbFeatures(AbstractFeatures):
    """ORB of Rublee et al. (2011), "ORB: an efficient alternative to SIFT or SURF", as OpenCV has it.

    `count` is the largest number of keypoints of a part of an image, `corner` the least difference of grey values of
    a corner (OpenCV's fastThreshold, of 255). Keypoints are whole pixels of the levels of a pyramid. Raises
    `ImportError` without OpenCV, the extra `features`.
    """

    count: int = 6000
    corner: int = 7

    def find(self, grey: np.ndarray, known: np.ndarray) -> Keypoints:
        """See `AbstractFeatures`."""
        found = opencv().ORB_create(nfeatures=self.count, scaleFactor=FINEST, fastThreshold=self.corner)
        return _found(found, grey, known, FINEST)


def opencv() -> Any:
    """OpenCV. Raises `ImportError` with the command that installs it."""
    try:
        import cv2  # pyright: ignore[reportMissingImports]  (an extra)
    except ImportError as error:
        raise ImportError("SIFT and ORB need the library OpenCV: pip install 'jaxgeo[features]'.") from error
    return cv2


def _found(detector: Any, grey: np.ndarray, known: np.ndarray, ratio: float | None = None) -> Keypoints:
    """Keypoints of OpenCV, which counts pixels from the centre of the first. `ratio` is that of a pyramid in which it
    multiplies positions without the half pixel."""
    points, descriptors = detector.detectAndCompute(_eight_bits(grey, known), known.astype(np.uint8))
    if not len(points):
        return Keypoints(np.zeros((0, 2)), np.zeros((0, 1), np.uint8 if ratio else np.float32), np.zeros(0))
    uv = np.array([point.pt for point in points], float)
    if ratio is not None:
        level = np.array([point.octave for point in points])
        uv += 0.5 * (ratio ** level[:, None] - 1.0)
    uv = np.clip(uv, -0.5, np.array(grey.shape[::-1]) - 0.5)
    return Keypoints(uv, np.asarray(descriptors), np.array([point.response for point in points], float))


def _eight_bits(grey: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Grey values from 0 to 255; unknown ones are the mean."""
    if not known.any():
        return np.zeros(grey.shape, np.uint8)
    low, high = np.percentile(grey[known], STRETCHED)
    values = np.where(known, grey, np.mean(grey[known]))
    return np.rint(np.clip((values - low) / max(high - low, 1e-12), 0.0, 1.0) * 255.0).astype(np.uint8)
