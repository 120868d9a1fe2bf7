"""What builds, starts and tests RobotKube on one machine: tool chain, images, clusters, checks."""
