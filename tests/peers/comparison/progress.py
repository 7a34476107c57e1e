"""What is being done, on standard error."""

import sys
import time

BEGIN = time.monotonic()


def note(text):
    print(f"{time.monotonic() - BEGIN:6.0f} s  {text}", file=sys.stderr, flush=True)
