"""Changes of the fleet: compasses that changed, events since the last run, states of aircraft."""
