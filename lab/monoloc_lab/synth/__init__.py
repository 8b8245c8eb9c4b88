"""Synthetic recordings with known truth: furnished rooms, quadrotor flights, physically based light.

Only rendering needs the extra ``synth`` (Mitsuba 3). Rooms, flights and the models of light and sensors need only
NumPy and OpenCV.
"""
