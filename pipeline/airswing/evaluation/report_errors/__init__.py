"""The error of the reports alone, with the reference's share of a disagreement taken off."""
