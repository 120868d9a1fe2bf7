"""Container images from the Dockerfiles of operator/images/, built without a daemon, as reproducible OCI archives.

`building.build_images` is what other parts call; `python -m ci.images` is the command. See README.md here.
"""
