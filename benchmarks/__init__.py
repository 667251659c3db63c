"""Measured ratios: how fast the parts of RISFleet are beside what they replace.

| module | measures |
|---|---|
| `engine` | the stacked learner against four of `agent.reference` |
| `env_step` | a joint step of the world against CartPole, and worlds in a batch |
| `scaling` | joint steps and updates per second for 1 to 32 robots in one process |
| `parts` | where the time of a local joint step goes |
| `deployment` | the link's share of a joint step, and what lockstep costs |
| `runs` | whole runs: simulation against local, Flower's share, evaluations' share |

Every ratio compares two things that take turns in one run, so that a machine's load falls on
both. Absolute times are shown beside them and hold for one machine and moment only.
"""
