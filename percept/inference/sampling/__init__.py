"""Sampling a density with emcee until every reported endpoint is as accurate as was asked."""
