"""Which directions of a cone or a window are free?"""
