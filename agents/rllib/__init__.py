"""Training on Ray RLlib, on one machine or a cluster; see :mod:`chemlab.agents.rllib.train`."""
