"""The page: its messages, its session and its tasks, with the files that a browser loads."""
