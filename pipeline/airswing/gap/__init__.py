"""The gap between simulated and real reports: where, which effect, how far it closes."""
