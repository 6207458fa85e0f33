"""`python -m tests.code CODE ARGUMENTS` is `python -c CODE ARGUMENTS`, for a fork of what has imported all."""

import sys

if __name__ == "__main__":
    _, code, *arguments = sys.argv
    sys.argv = ["-c", *arguments]
    exec(code, {"__name__": "__main__"})
