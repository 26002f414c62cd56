"""Further kinds of model file, one a module (:mod:`airswing.model_formats`); none is needed yet."""
