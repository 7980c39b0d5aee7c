"""What a thing costs, as ratios within one run to a plain reference of the same work: `python -m benchmarks`."""
