"""Many runs: one engine, and the tools on it: campaign, comparison, fault catalogue, reproduction, verification, hunt.

The engine: ``job.py`` (a run to do, and its outcome), ``keys.py`` (what decides an outcome), ``plan.py`` (which jobs
are next: a list or a search), ``plan_file.py`` (files that users write), ``pool.py`` (worker processes; with
``--scheduler`` ``dask_pool.py``), ``worker.py`` and ``run.py`` (doing one), ``store.py`` (outcomes that outlive a
kill), ``resumable.py`` (a search that goes on where it was), ``figures.py`` (names of figures), ``output.py``.
``baselines.py`` makes baselines of scenarios.
May import: ``runtime``, ``review`` and what these may. To add a tool: a folder with a plan, which makes jobs by
``make_job`` and has them done by ``run_jobs``, ``run_plan`` or ``run_resumable``, and a page, which shows the outcomes;
then its command in ``hil/cli/``. A kind of job of its own is one function that the job names. A search is a class with
``next_jobs``; ``tests/test_batch_engine.py`` has a small one.
"""
