"""All that touches the disk: readings in, projects and results in and out."""
