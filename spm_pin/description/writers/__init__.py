"""From a `RobotDescription` to files; each writer refuses what its format cannot say."""
