"""Aircraft reports in: CSV, Parquet, MADIS ACARS NetCDF and AMDAR BUFR to one Dataset.

Assumes winds and positions as the aircraft sent them; nothing is corrected here beyond what
:mod:`airswing.reports.canonical` states, and every repair or drop is counted.
"""

from airswing.reports.read import iter_frames, read_reports
from airswing.reports.summary import reports_summary

__all__ = ["iter_frames", "read_reports", "reports_summary"]
