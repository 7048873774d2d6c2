"""``python -m hframe_post``."""

from hframe_post.cli.main import main

if __name__ == "__main__":
    main()
