"""The provider `k3s`: a k3s that somebody set up, on this machine and others or elsewhere, as `existing` takes it, with
what is known of k3s: its files, its folder of images, its storage and its network."""
