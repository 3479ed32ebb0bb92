"""Picture of a running drive in the terminal."""
