"""The child process of a fit: `python -m freerein_imitation.fit FOLDER DATA_DIR DEVICE`."""

import gc

if __name__ == "__main__":
    gc.disable()  # modules stay: to look for garbage among their objects takes a fifth of the start

import sys
from pathlib import Path

from freerein_imitation.methods import METHODS

if __name__ == "__main__":
    gc.freeze()
    gc.enable()
    raise SystemExit(METHODS.run_fit(Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3]))
