"""Where the parts meet: set-up, start and the scripts around a run."""
