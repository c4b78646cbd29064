"""`python -m host_sync` runs `retrosync`."""

import sys

from host_sync.cli.start import main

if __name__ == "__main__":
    sys.exit(main())
