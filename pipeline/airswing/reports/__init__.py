"""Aircraft reports in: files of any known format to one Dataset.

Assumes winds and positions as the aircraft sent them; nothing is corrected here beyond what
:mod:`airswing.reports.canonical.cleaning` states, and every repair or drop is counted.
"""

from airswing.reports.assembly import assemble
from airswing.reports.canonical.audit import Audit
from airswing.reports.file_summary import reports_summary
from airswing.reports.files import expand
from airswing.reports.read import read_file, read_reports

__all__ = ["Audit", "assemble", "expand", "read_file", "read_reports", "reports_summary"]
