"""Run `meshfit` as `python -m meshfit`."""

from meshfit.cli.main import main

if __name__ == "__main__":
    main()
