"""A run, whatever the runtime: who decides, what is aggregated, written and resumed.

| module | holds |
|---|---|
| `session` | one training run, everything but where the robots are |
| `coordinator` | Algorithm 1 of the paper against a `lockstep.Fleet` |
| `controllers` | who steers the RIS: access point, one agent for everything, rules, frozen |
| `aggregation` | Flower's strategies over rows of weights; the only place that imports Flower |
| `evaluation` | frozen weights on held-out starts |
| `run_folder` | what the files of a run's folder are called, and how they are read and written |
| `recording` | what a run records as it goes |
| `checkpoint`, `resume` | where a run goes on |
| `preflight`, `addresses`, `engine_limits` | what can be known to be wrong before a run starts |
| `partition`, `communication` | who holds which robots, and what is sent |
| `run_log` | log lines that say which run, round and robots they are about |
"""
