"""A world whose truth is known: furnished rooms, quadrotor flights, physically based light.

Only rendering needs the extra ``synth`` (Mitsuba 3); rooms, flights and the models of light and sensors need NumPy
and OpenCV alone.
"""
