"""The statistical model: candidates, sums, scores, selection, closure (docs/gap.md)."""
