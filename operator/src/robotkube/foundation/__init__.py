"""What all others stand on: documents, processes, Kubernetes, database and forge."""
