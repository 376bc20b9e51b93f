"""What every room needs and no physics knows: files, text, cores, compiled programs, many tasks."""
