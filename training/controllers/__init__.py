"""Who steers the RIS, and frozen policies."""
