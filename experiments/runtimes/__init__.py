"""Starting and stopping runs, in this process and on Flower."""
