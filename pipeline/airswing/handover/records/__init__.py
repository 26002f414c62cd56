"""What formats that write reports share: which reports, in which order, in which columns."""
