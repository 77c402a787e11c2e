"""The documentation site: built from `deploy/docs`, its links followed, its commands run where that can be."""
