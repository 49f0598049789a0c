"""`python -m packit_sim` is `packit`."""

from packit_sim.cli import main

if __name__ == "__main__":
    main()
