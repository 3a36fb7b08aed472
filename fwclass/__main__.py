"""``python -m fwclass`` is the command `fwclass`. What Python itself loads before it knows this is safe only with
``python -P -m fwclass``."""

from fwclass.isolation import isolate

isolate()

from fwclass.cli import main  # noqa: E402 - after the import path is clean

if __name__ == "__main__":
    main()
