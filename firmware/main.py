"""Runs the node after power-on."""

from node import main

main()
