"""Export of corrected winds to WRF's nudging, WRFDA, GSI and JEDI, and correction of forecasts.

Assumes the corrected product of a run, or the Dataset of :func:`airswing.correct`. A format of
:data:`~airswing.handover.export.FORMATS` is the module of its name.
:mod:`~airswing.handover.forecasts` corrects forecasts by their past errors.
"""
