"""`python -m packit_sim` is `packit`."""

from packit_sim.cli.app import main

if __name__ == "__main__":
    main()
