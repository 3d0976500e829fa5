"""The command, as `residyn` and as `python -m residyn`.

Ctrl-C ends it in one line at any time. Libraries that are being imported may catch and forget an
interrupt, so until the work begins, before which nothing is written, it ends the process at once.
Nor is garbage collected until then: there is none in what packages make, and looking for it takes a
tenth of a short command's time.
"""

import gc
import os
import signal
import sys
from typing import NoReturn


def stop(*_: object) -> NoReturn:
    """End the process now."""
    os.write(2, b"residyn: interrupted\n")
    os._exit(130)


def main() -> int:
    """Run the command line; returns the exit status."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:  # else somebody ignores it
        signal.signal(signal.SIGINT, stop)
    gc.disable()
    from .cli import main as run

    return run()


if __name__ == "__main__":
    sys.exit(main())
