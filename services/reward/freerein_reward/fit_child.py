"""The child process of a fit: `python -m freerein_reward.fit_child FOLDER DATA_DIR DEVICE GROUNDING_FOLDER`.

GROUNDING_FOLDER holds a version of the grounding model and is named after it. Captions are cached in FOLDER.
"""

import sys
from pathlib import Path

from freerein import program
from freerein_reward.methods import METHODS

if __name__ == "__main__":
    folder, data_dir, device, grounding = sys.argv[1:]
    program.end(METHODS.run_fit(Path(folder), Path(data_dir), device, grounding=Path(grounding), captions=Path(folder)))
