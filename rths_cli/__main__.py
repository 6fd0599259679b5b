"""`python -m rths_cli` is `rths`."""

from rths_cli.cli import main

if __name__ == "__main__":
    main()
