"""What no mean shows: coded values, gross errors, distributions of what is sent."""
