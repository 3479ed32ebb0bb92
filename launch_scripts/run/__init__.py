"""Starting nodes and following a drive."""
