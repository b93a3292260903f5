"""`python -m limbcli` is the command line."""

from limbcli.cli.entry import main

if __name__ == "__main__":
    main()
