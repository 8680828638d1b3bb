"""Sweeps: practice runs over grids of configurations, and maps of what comes of them."""
