"""Programs that generate and check the documentation pages."""
