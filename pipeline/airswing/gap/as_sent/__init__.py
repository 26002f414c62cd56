"""Winds sent so wrongly that they are set right before anything is fitted.

``repeated`` finds values that stuck, ``wind_maps`` winds in another unit or with components
exchanged, ``late_heading`` headings that lag in turns, ``ceiling`` a bound on the speeds;
``in_turn`` looks for one after the other. What each finds is a ``mended.Mended``.
"""
