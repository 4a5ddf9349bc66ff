"""The corrected arm in the words of a simulator: joints, actuators and what to draw at random, to be pasted."""
