"""Is the shaft free from one direction, and on a turn between two?"""
