"""Documents as people and programs write them: strict reading, YAML and JSON, patterns, schemas, templates."""
