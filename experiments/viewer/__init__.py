"""What people look at: episodes as pages and films, and a page that follows a run."""
