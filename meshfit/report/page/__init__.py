"""One page for some runs: everything that their files say, in a single HTML file that needs nothing else."""
