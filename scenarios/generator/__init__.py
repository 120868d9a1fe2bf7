"""Makes the data of a scenario: routes, the scene the lidars see, and one rosbag2 folder per vehicle."""
