"""From samples to alarms: the gap of a block, what it says of the parameters, the tests for a change."""
