"""Whether and when a compass changed."""
