"""Commands about bundles: the platform in one file."""
