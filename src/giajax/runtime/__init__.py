"""Common infrastructure without physics: files, text, cores, compiled programs and tasks."""
