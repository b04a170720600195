"""Second thoughts: each name that was found is judged again beside all the others, and against chance."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import replace

from hubodo.gap.judge.round import DECIDED, Round
from hubodo.gap.judge.search import SearchResult, Watch
from hubodo.gap.refit.refit import Refit, gain_over, refit, refit_with_weights

# Names replaced at most: two that take each other's place would go on for ever.
_TIMES = 3
# Of more names than so many only those are looked at again that were added on trial, or that have lost half
# of what they gained when they were found: a turn costs a round for each.
_MANY, _LEFT = 4, 0.5
# Of the progress, where this begins, and what it is.
_FROM, _SHARE = 0.75, 0.15

Rounds = Mapping[tuple[str, str], Round]
"""By effect and scope, the round that judged it."""


def reconsider(
    found: SearchResult,
    accept: Collection[str] = (),
    reject: Collection[str] = (),
    watch: Watch | None = None,
) -> tuple[SearchResult, Rounds]:
    """Each effect that was found is taken out and looked for again beside all the others.

    What came in as a proxy for something that was found later leaves; what has a better rival is replaced.
    accept: names that stay all the same, as sure as they are. reject: names not considered.
    """
    watch, rounds = watch or Watch(), dict[tuple[str, str], Round]()
    as_found = {made.best.label: made for made in found.rounds if made.best is not None}
    final, replaced = found.final, 0
    names = [term for term in final.state.terms if term.fitted]
    if len(names) == 1 and names[0].key in as_found and not found.decimated and not accept:
        # Alone it was judged beside all the others already.
        return found, {names[0].key: as_found[names[0].key]}
    changed = True
    while changed:
        changed, settled = False, _settled(final, as_found)
        names = [term for term in final.state.terms if term.fitted]
        doubted = [term for term in names if term.key not in settled]
        rounds = {term.key: settled[term.key] for term in names if term.key in settled}
        for k, term in enumerate(doubted):
            without = [other for other in final.state.terms if other.key != term.key]
            swapped = final.state.afresh(without)
            also = [term.key] if term.moves and term.effect.name in accept else []
            part = (replaced + k / len(doubted)) / (_TIMES + 1)
            watch.say(f"reconsidering {term.words}", _FROM + _SHARE * min(part, 1.0))
            made = watch.journal.look(final.point.at(swapped), reject, also)
            rounds[term.key] = made
            best = made.best
            if term.effect.name in accept or (best is not None and best.label == term.key):
                continue
            if best is not None and replaced == _TIMES:
                # It only says how sure the name is.
                continue
            if best is not None:
                replaced += 1
                as_found[best.label] = made
                swapped = swapped.with_terms([*without, best.term])
            final, changed = refit_with_weights(swapped), True
            break
    for key, made in rounds.items():
        if made.rival(key) is None and key[0] not in accept:
            # Others of its kind took its place among the rivals: it counts as it was found.
            rounds[key] = as_found.get(key, made)
    return replace(found, final=final), rounds


def _settled(final: Refit, as_found: Rounds) -> dict[tuple[str, str], Round]:
    """The names that stay as they were when they were found, each with its round."""
    made = {}
    names = [term for term in final.state.terms if term.fitted]
    for term in names if len(names) > _MANY else []:
        own = as_found[term.key].rival(term.key) if term.key in as_found else None
        without = [other for other in final.state.terms if other.key != term.key]
        if own is None or not term.moves:
            continue
        left = gain_over(refit(final.point.at(final.state.afresh(without)), rounds=2), final)
        if left > _LEFT * own.gain:
            made[term.key] = as_found[term.key]
    return made


def beyond_chance(
    found: SearchResult, rounds: Rounds, accept: Collection[str] = ()
) -> tuple[SearchResult, Rounds]:
    """Without what the best of all candidates would gain by chance, in what the finished model leaves.

    Only of effects that show in the mean; accept: names that stay all the same.
    """
    null = found.rounds[-1].null
    by_chance = set()
    for key, made in rounds.items():
        own = made.rival(key)
        if own is not None and own.state is not None and own.p_value(null) >= 1.0 - DECIDED:
            by_chance.add(key)
    kept = [it for it in found.final.state.terms if it.key not in by_chance or it.effect.name in accept]
    if len(kept) == len(found.final.state.terms):
        return found, rounds
    return replace(found, final=refit_with_weights(found.final.state.afresh(kept))), rounds
