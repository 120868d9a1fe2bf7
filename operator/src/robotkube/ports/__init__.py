"""The ports: what services need of the world; adapters and `testing` implement them. One module per part."""
