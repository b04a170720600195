"""The first look: what each candidate would gain if the model were linear."""
