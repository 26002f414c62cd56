"""Corrected winds handed over: to WRF's nudging, WRFDA, GSI and JEDI, and back to the unit.

Assumes ``corrected.nc`` of a run, or the Dataset of :func:`airswing.correct`. Every module of this
folder that calls :func:`~airswing.handover.records.registry.register` is an export format: adding
one means adding one file here. :mod:`~airswing.handover.records` holds what formats share that
write reports.
"""
