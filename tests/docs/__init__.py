"""The documentation site: built from `deploy/docs`, its links followed, and every command in it run."""
