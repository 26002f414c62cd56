"""What a fit keeps of each period of an archive, so that the next one need not read it."""
