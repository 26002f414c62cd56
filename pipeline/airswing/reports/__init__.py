"""Aircraft reports in: files of any known format to one Dataset.

Assumes winds and positions as the aircraft sent them; the only corrections are those stated in
:mod:`airswing.reports.cleaning`, and every repair or drop is counted.
"""

from airswing.reports.assembly import assemble
from airswing.reports.audit import Audit
from airswing.reports.read import expand, read_file, read_reports, reports_summary

__all__ = ["Audit", "assemble", "expand", "read_file", "read_reports", "reports_summary"]
