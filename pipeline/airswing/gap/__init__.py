"""The gap between simulated and real reports; `airswing.gap.diagnose` calls its parts in order.

Equations and files: docs/gap.md. Whether it is right on sealed archives: `airswing.blind_check`.
"""
