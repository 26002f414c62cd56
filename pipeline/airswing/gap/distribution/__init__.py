"""Effects that change no mean: coded values, gross errors, distributions of reported values."""
