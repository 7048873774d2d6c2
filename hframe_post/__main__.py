"""``python -m hframe_post``."""

from hframe_post.cli import main

if __name__ == "__main__":
    main()
