"""`python -m meshfit` is `meshfit`."""

from meshfit.cli.main import main

if __name__ == "__main__":
    main()
