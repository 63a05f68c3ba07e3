"""The command as `python -m plotfeed.feeds.cli`."""

from plotfeed.feeds.cli.main import main

if __name__ == "__main__":
    main()
