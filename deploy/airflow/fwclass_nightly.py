"""A DAG for Apache Airflow 3: the command that anyone would type, every night, and its history as the task's result.

Exit code 3 (some parts failed, the others are delivered) marks the task as skipped, so that it is seen and does not
stop the pipeline; 1, 2, 4 and 130 fail it, and it is tried once more: a run goes on where the last one ended.
For Airflow 2 take `from airflow import DAG` and `from airflow.operators.bash import BashOperator`.
"""

from __future__ import annotations

from datetime import UTC, datetime, timedelta

from airflow.providers.standard.operators.bash import BashOperator
from airflow.sdk import DAG

PROGRAM = "/opt/fwclass/bin/fwclass"
CONF = "/data/my-survey.yaml"
RUN = "/data/runs/my-survey"

with DAG(
    dag_id="fwclass_nightly",
    schedule="0 3 * * *",
    start_date=datetime(2026, 1, 1, tzinfo=UTC),
    catchup=False,  # nights that were missed are one run
    max_active_runs=1,  # the run directory has one writer
    default_args={"retries": 1, "retry_delay": timedelta(minutes=10)},
    tags=["lidar"],
) as dag:
    run = BashOperator(
        task_id="run",
        bash_command=f"exec {PROGRAM} run {CONF} --out {RUN}",  # exec: the task's SIGTERM reaches the run itself
        env={"PYTHONSAFEPATH": "1"},  # import nothing from the directory that the task starts in
        append_env=True,
        skip_on_exit_code=3,
        execution_timeout=timedelta(hours=20),
    )
    history = BashOperator(
        task_id="history",
        bash_command=f"{PROGRAM} history {RUN} --last 1 --json | tr -d '\\n'",  # one line: the task's XCom
        trigger_rule="all_done",
    )
    run >> history
