"""Benchmark datasets: samples drawn from a campaign, shards of them, their index, and what reads and checks them."""
