"""Study files: schema and scenarios."""
