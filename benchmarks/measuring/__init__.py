"""What every measurement stands on: comparisons with a baseline, robot processes as pods, small bags."""
