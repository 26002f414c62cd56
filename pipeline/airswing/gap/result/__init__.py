"""Statement of a diagnosis: parameters, credible sets, gap.json."""
