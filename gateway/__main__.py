"""`python -m gateway` is the `drivegate` command, for places where no script is installed."""

from gateway.cli import main

if __name__ == "__main__":
    main()
