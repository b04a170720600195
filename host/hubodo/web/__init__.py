"""The live page of a recording and the recordings themselves over HTTP, and Foxglove's live protocol."""
