"""Whether this machine can run Gapscope: packages, and engines that agree with pinocchio."""
