// Job type of Flamenco 3 for IRIS: the tasks that `iris farm JOBS.toml --out BUNDLE` wrote into BUNDLE/flamenco_job.json.
// Copy this file into the folder "scripts" of the Flamenco Manager.

const JOB_TYPE = {
    label: "IRIS Rooms",
    description: "Solve captures and render their frames",
    settings: [
        { key: "jobs", type: "string", required: true, subtype: "file_path",
          description: "The job file, where all workers see it" },
        { key: "iris", type: "string", default: "iris", description: "The program iris on the workers" },
        { key: "tasks", type: "string", required: true,
          description: "The tasks, as written by iris farm: their names, arguments and what they wait for" },
    ],
};

function compileJob(job) {
    const settings = job.settings;
    const made = {};
    for (const listed of JSON.parse(settings.tasks)) {
        const task = author.Task(listed.name, listed.type);
        task.addCommand(author.Command("exec", {
            exe: settings.iris,
            args: ["batch", settings.jobs].concat(listed.arguments),
        }));
        for (const name of listed.after) {
            task.addDependency(made[name]);
        }
        made[listed.name] = task;
        job.addTask(task);
    }
}
