"""Agents for chemlab: scripted policies for every role, and what is needed to run and evaluate policies."""
