"""Many environments of one arm in one process, stepped together on MuJoCo."""
