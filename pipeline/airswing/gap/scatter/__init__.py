"""What shows in no mean: lattices of coded values, gross errors, reports that scatter more."""
