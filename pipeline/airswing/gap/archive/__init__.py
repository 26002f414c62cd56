"""An archive of reports against one reference, as plain arrays and derived variables."""
