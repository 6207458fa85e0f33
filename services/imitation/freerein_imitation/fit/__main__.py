"""The process of a fit."""

import sys
from pathlib import Path

from freerein_imitation.fit import main

if __name__ == "__main__":
    raise SystemExit(main(Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3]))
