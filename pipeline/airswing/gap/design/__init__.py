"""Columns: weather's, effects', the nonparametric basis, and the candidates made of them."""
