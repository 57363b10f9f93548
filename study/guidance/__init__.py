"""An image-guided robot, simulated from first causes: frames, tracker, calibration, filters, fusion, control.

After Baron: what the paper measured on two real systems follows here from what such systems are made of.
"""
