"""Readers of channel files that other programs wrote."""
