"""Input checks, fallbacks and guard around a controller."""
