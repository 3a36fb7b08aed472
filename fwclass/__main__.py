"""``python -m fwclass`` is the command `fwclass`."""

from fwclass.cli import main

if __name__ == "__main__":
    main()
