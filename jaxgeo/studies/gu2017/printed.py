"""Printed values of Gu and Qiao (2017); Table 1 is an image, so only its outcome as stated in the text is used."""

from __future__ import annotations

BETTER_THAN = 100.0  # m, "usually", at large angles off nadir
ORDERS = 2.0  # of magnitude, between direct and updated errors
CIRCLE_90 = 2.164  # standard deviations, for the circles in Fig. 5
SEARCHED = 3.0  # standard deviations
SEARCHED_HOLDS = 0.99  # "above", of images within that
BLOCKS = 16  # of Fig. 2
BLOCK = 300  # px on a side, "about"
TIES = 20
