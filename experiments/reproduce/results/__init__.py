"""What runs came to: tables, points, statistics, verdicts."""
