"""A filter that runs along with a recording, block by block, and the test for a change between blocks."""
