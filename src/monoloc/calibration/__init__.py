"""Calibration of a camera by a printed board: intrinsics, distortion and their uncertainty."""
