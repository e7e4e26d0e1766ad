"""Look at sequences and runs: sheets of pictures, videos, the Rerun viewer."""
