"""The child process of a fit: `python -m freerein_segmentation.fit_child FOLDER DATA_DIR DEVICE`."""

import sys
from pathlib import Path

from freerein import program
from freerein_segmentation.methods import METHODS

if __name__ == "__main__":
    program.end(METHODS.run_fit(Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3]))
