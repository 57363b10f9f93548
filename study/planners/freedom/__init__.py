"""What the planners ask of a robot's freedom; 4 and 5 degrees answer it in `tilting` and `pointing`."""
