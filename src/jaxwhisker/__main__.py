"""`python -m jaxwhisker` is the installed command `jaxwhisker`."""

import sys

from jaxwhisker.cli import main

if __name__ == "__main__":
    sys.exit(main())
