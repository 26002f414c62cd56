"""Aircraft reports in: CSV, Parquet, MADIS ACARS NetCDF and AMDAR BUFR to one Dataset.

Assumes winds and positions as the aircraft sent them; nothing is corrected here beyond what
:mod:`airswing.reports.canonical.cleaning` states, and every repair or drop is counted.
"""

from airswing.reports.file_summary import reports_summary
from airswing.reports.read import read_reports

__all__ = ["read_reports", "reports_summary"]
