"""`make reference`: pages and tables of the documentation that are written from code, schemas, charts and results."""
