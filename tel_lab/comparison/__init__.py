"""What practice is compared with: other ways to follow a path, and how the results are summed up."""
